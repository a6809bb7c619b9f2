"""The office: layouts, the rover and its drives, people, the bumper, and what stands on links.

MuJoCo and plane geometry. Knows no radio: it imports the config and `mjris.jit` alone.
"""

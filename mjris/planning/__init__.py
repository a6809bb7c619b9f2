"""Where to drive: ways on the floor, sight between its squares, and what places are worth.

Imports `mjris.world` and `mjris.radio`; it does not know who steps the cells.
"""

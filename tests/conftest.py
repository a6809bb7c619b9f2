from hypothesis import settings

# A first example waits for the compiler; how fast things are is for scripts/bench.py to say.
settings.register_profile("mjris", deadline=None)
settings.load_profile("mjris")

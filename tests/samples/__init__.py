"""Makes the captures that ship with the project; ``python -m tests.samples`` writes `captures/` anew.

The same code always gives the same bytes: times are fixed, jitter comes from a seeded generator, and no
figure depends on the platform's mathematics library.
"""

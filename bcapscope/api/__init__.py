"""The public functions and classes that other programs import from `bcapscope`."""

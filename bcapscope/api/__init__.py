"""What other programs use: the functions and classes behind the names of `bcapscope`."""

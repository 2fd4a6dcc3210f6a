"""Tables of the functions, commands, result codes and variables of b-CAP, and of the meanings of values."""

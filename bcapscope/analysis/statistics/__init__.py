"""Statistics of calls, and distributions of values in bounded memory."""

"""Statistics of calls, and distributions in bounded memory."""

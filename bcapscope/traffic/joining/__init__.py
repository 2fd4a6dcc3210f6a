"""Join what several places captured of one conversation, such as both legs of a proxy."""

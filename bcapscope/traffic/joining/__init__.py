"""Join the captures of one conversation from several places, such as both legs of a proxy."""

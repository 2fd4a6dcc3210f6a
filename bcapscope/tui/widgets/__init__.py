"""A module for each widget; a widget posts messages and never reaches into another."""

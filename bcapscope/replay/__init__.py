"""Recorded sessions, played again: the client's side or the controller's."""

"""Captures: files, standard input and live interfaces become observations."""

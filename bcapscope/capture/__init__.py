"""Captures: turn files, standard input and live interfaces into observations, and write recordings."""

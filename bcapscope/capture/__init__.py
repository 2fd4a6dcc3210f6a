"""Captured packets: files, standard input and live interfaces in, observations out."""

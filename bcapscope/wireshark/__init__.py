"""Wireshark: a dissector and coloring rules that are generated from the tables of the protocol."""

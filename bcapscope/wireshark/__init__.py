"""A dissector and coloring rules for Wireshark, generated from the protocol's tables."""

"""Tests of the Wireshark dissector."""

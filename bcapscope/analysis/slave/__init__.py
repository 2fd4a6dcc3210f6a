"""Slave."""

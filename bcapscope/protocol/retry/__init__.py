"""Retries: the requester sends them for a client, and the responder recognises them for a controller."""

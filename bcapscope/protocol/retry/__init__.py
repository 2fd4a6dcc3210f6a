"""Retries at both ends of a call: the client's requester and the controller's responder."""

"""Transports for asyncio: UDP, TCP and memory links. They do not interpret the bytes they carry."""

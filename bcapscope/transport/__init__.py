"""Transports for asyncio: UDP and TCP. They do not interpret the bytes they carry."""

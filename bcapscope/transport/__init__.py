"""Transports: UDP, TCP and memory links for asyncio. They know nothing of the bytes they carry."""

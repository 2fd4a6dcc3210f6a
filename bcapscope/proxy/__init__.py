"""In the middle between clients and controllers: bytes pass at once, unless a rule says otherwise."""

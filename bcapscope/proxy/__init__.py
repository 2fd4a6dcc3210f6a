"""The proxy: forwards traffic between clients and controllers; rules can change it."""

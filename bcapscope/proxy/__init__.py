"""The proxy forwards traffic between clients and controllers. Rules can change the traffic."""

"""The wire protocol, its endpoints, and a client for it."""

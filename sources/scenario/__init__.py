"""Simulated worlds: where the UEs are, how they move, and the channels they see."""

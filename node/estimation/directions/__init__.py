"""Directions in azimuth and elevation, for arrays that are no uniform line."""

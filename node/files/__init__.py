"""MCAP recordings and chart logs, and calibration files."""

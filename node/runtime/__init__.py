"""Processes and sockets: dispatch, workers, collector, supervision, status."""

"""Where charts go: publisher, logs, recorder, metrics, live view."""

"""What everything passes on: frames, charts, arrays, counters, errors and the base of settings."""

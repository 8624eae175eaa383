"""Signal processing: arrays in, arrays out. Nothing here knows of sockets, files or configuration."""

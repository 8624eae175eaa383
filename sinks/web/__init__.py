"""A small HTTP and WebSocket server in a thread of its own, for sinks that browsers and monitoring ask."""

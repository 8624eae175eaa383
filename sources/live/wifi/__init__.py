"""Tools that read CSI from Wi-Fi cards, live: what importers decode of files, as it comes over the wire."""

"""One position a UE from the frames of several arrays."""

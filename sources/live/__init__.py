"""Live devices that speak a protocol of their own, each with a codec without input or output, thin input and
output around it, and a simulated device."""

"""KrakenSDR: directions of transmitters from coherent receivers, by heimdall frames of IQ samples."""

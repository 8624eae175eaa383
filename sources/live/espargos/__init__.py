"""ESPARGOS boards: eight phase-coherent Wi-Fi receivers, 2 x 4 antennas."""

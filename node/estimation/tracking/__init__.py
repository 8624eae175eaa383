"""Where moving UEs are, from one observation after the other."""

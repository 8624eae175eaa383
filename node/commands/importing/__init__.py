"""What `chachart import` is made of: options to frames, an array, and a report."""

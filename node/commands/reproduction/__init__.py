"""What `chachart reproduce` is made of: the published numbers, the runs beside them, figures and report."""

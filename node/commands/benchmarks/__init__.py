"""What `chachart bench` measures, one module a benchmark."""

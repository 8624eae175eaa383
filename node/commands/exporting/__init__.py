"""What `chachart export` writes, one module a kind of content."""

"""What a node is told: TOML in, validated settings out."""

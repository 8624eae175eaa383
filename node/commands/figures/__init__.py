"""The figures of `chachart plot`, one module a family; matplotlib is imported with them only."""

"""One file per command line tool."""

"""What a chachart node does: data types, wire protocol, estimation, runtime and command line tools."""

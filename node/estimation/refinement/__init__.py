"""A chart that knows its neighbours: UEs are pulled to where UEs with channels like theirs are."""

"""The protocol of a gap diagnosis, played through the graph and recorded."""

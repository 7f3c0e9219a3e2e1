"""Messages that nobody should send, thrown at every subscription of every node."""

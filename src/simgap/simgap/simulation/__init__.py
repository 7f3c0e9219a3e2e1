"""What a model does: variants of it, windows of a recording, and their replay; nothing that is fitted."""

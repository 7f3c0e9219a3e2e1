"""What is shown: a diagnosis as a page to read, with its figures and sentences."""

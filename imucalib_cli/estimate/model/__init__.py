"""The unknowns, and what a filter window says of them."""

"""The validation set: held-out scenes at several scales, rendered compactly, and every method measured on them."""

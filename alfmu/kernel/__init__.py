"""The kernel: the method traced over a mechanism's equations into flat functions, and the ways to run them."""

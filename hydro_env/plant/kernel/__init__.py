"""The compiled step: the right-hand side and chosen effects as vectorised machine code."""

"""The thesis's three marker programs (Appendices A, B and C), and what goes beyond them."""

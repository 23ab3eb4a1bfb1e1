"""What ``mvuav demo`` runs."""

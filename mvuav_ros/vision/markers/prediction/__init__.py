"""Where each light will be next."""

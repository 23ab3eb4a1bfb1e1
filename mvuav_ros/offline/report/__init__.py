"""Tables and figures as one HTML page, CSV and JSON."""

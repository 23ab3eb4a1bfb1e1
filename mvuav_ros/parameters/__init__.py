"""What a user can set, per node: declared, documented, validated and converted in one place."""

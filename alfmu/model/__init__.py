"""What a user declares: mechanisms with bodies, joints and forces; units, settings, errors."""

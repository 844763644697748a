"""What stages are told: configuration classes and presets."""

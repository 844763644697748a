"""Configuration of stages and commands: configuration classes, presets and tasks' defaults."""

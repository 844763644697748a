"""The built-in tasks, one module per task or group of tasks."""

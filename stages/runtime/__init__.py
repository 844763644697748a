"""What a run needs: devices, processes, progress, checkpoints, seeding."""

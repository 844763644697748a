"""Infrastructure of runs: devices, processes, progress, outputs, checkpoints, interrupts, seeding."""

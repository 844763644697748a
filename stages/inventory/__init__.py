"""What is in folders of artifacts: what each is, how good it is, and what could be removed."""

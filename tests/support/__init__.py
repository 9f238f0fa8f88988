"""What several tests use: independent solutions of the model, hosts that call it, scene files and what they leave."""

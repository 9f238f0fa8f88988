"""What several tests use: independent solutions of the model, and a host that calls the UMAT as finite-element codes do."""

"""Networks, losses, batches and the training loop that every trained method shares; the truth is never opened here."""

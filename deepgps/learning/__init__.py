"""Networks, losses, batches and the training loop that every trained method shares.

Each method's own steps are in ``deepgps.methods``; the ground truth is never opened here.
"""

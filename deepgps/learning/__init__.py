"""Networks, losses, batches and the training loop that every trained method shares.

A method's own steps are in ``deepgps.methods``; the truth is never opened here.
"""

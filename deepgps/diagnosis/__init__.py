"""What is wrong with the wheels of a recording: estimates with intervals, findings and their text. No ground truth.

Methods take the diagnosed noise and track width from here; nothing here trains, and nothing imports torch.
"""

"""Files that are complete or absent, in which any changed bit is detected.

Every file is written under a temporary name, synced and renamed. Files that a later stage reads are checked: JSON
contains the SHA-256 of its own values, ``.npz`` archives the CRC-32 of each array, and the SHA-256 of other files is in
a JSON file or in a file ``<name>.sha256`` next to them.
"""

"""Several aircraft beside one target: who watches from which side, and how they stay apart."""

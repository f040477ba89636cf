"""What a flight looked like afterwards: its history, figures, and one self-contained page."""

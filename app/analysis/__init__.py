"""What a flight came to: replay, score and summary."""

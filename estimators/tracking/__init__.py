"""From readings to a target track: source choice, pairing, gating, track quality, fusion."""

"""Payload drivers: laser range and gimbal angles by the payload's own protocol, where no autopilot forwards them."""

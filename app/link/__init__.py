"""The link to the vehicle: MAVLink messages in and out, and what they mean."""

"""A gimbal camera as the payload: pictures in, tracking status and pointing out. Needs the extra ``video``."""

"""Access control of the page and of its buttons.

On loopback every user of this machine has both. On other addresses the printed URL carries a token, for the operator
or for viewers; it is exchanged for a session cookie. The latest session with the operator's token may use the
buttons; all others are read-only. Pure except for the random session names.
"""

from __future__ import annotations

import ipaddress
import secrets

from sidelong.app.view.address import LOOPBACK

_SESSIONS_MAX = 100


class Access:
    """The sessions. host: the address that is served at; tokens: what was printed, '' on loopback."""

    def __init__(self, host: str, operator_token: str, viewer_token: str) -> None:
        self.local = host in LOOPBACK
        self._host = host
        self._tokens = {"operator": operator_token, "viewer": viewer_token}
        self._sessions: dict[str, str] = {}  # the roles
        self._operator = ""

    def knows_host(self, name: str) -> bool:
        """Return whether a Host header matches the served address, to reject requests by another host name."""
        name = name.rpartition(":")[0] if name.rpartition(":")[2].isdigit() else name
        if self.local:
            return name in LOOPBACK
        if name == self._host:
            return True
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return True

    def entered(self, token: str) -> str | None:
        """Return a new session for a token, None for a wrong one. The operator's takes the buttons over."""
        given = token.encode()
        for role, right in self._tokens.items():
            if right and secrets.compare_digest(given, right.encode()):
                session = secrets.token_urlsafe(16)
                self._sessions[session] = role
                while len(self._sessions) > _SESSIONS_MAX:
                    oldest = next(one for one in self._sessions if one != self._operator)
                    del self._sessions[oldest]
                if role == "operator":
                    self._operator = session
                return session
        return None

    def sees(self, session: str) -> bool:
        """Return whether the page may be shown."""
        return self.local or session in self._sessions

    def refusal(self, session: str) -> str | None:
        """Return why a session may not press buttons; None if it may."""
        if self.local or (session and session == self._operator):
            return None
        if self._sessions.get(session) == "operator":
            return "another client has the buttons now; open the operator's address again to take them over"
        return "this page is for watching only"

    def who(self, client: str) -> str:
        """Return the name under which a button press is recorded."""
        return f"operator at {'this machine' if self.local else client}"

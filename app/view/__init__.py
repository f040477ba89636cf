"""The live map: a page in the browser, served by a process of its own so that it never holds up the flight.

    control loop -> ViewDisplay -> pipe -> server (python -m sidelong.app.view.server) -> browsers
                                <- pipe <-        buttons             <-

Each line of either pipe is one JSON object. The loop's end of the pipe never waits: what does not fit is left out,
and what must not be lost (words, the trail) goes with the next line that does.
"""

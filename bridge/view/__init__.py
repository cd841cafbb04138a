"""The page of ``poise view``: a robot in a browser, with controls for its topics and services."""

"""The page of ``poise view``: a robot in a browser, with buttons for its topics and services."""

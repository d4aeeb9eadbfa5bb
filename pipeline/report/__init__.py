"""``make report``: runs, or what is published of them, as one page that explains itself.

Files in, files out: nothing of a run is loaded or played again, so a report of a hundred runs takes
seconds, and a run of which something is missing is reported with a note of what.
"""

"""Documents, what makes a site of them (``docs.site``) and reads their data (``docs.lab``)."""

"""What was tried on the way, and the data of it (:mod:`docs.lab.data`)."""

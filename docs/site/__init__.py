"""The documentation site: pages of ``docs`` and what is generated from code and data.

``make docs`` runs :mod:`docs.site.__main__`: every page is copied to a build folder, what stands
there as ``<!-- generated: NAME ... -->`` is replaced by what :mod:`docs.site.directives` makes of
it, links to code lead to a page of that file at the line of the symbol that they name, and
Zensical makes HTML of it, a warning being an error. Nothing that is generated is committed.
"""

"""``python -m docs.site.new_page NAME``: the page of a new variant, to be filled in.

Everything that can be generated is marked; what its author must say is in capitals.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

from docs.site import variants
from docs.site.places import DOCS

METHODS: Final = DOCS / "methods"
TEMPLATE: Final = """---
variants: [{name}]
idea: {idea}
---
# {title}

WHAT IT IS, IN TWO SENTENCES, AND ITS SOURCE.

## Objective

```math
L = L_{{\\pi}}(B) + \\lambda \\, L_{{BC}}(D)
```

## Configuration

<!-- generated: variant-yaml -->

What is not named there has the preset's value, and behind it the default of the
[settings](../reference/settings.md). Try it: `make train VARIANT={name} PRESET=smoke`.

## In the code

- WHAT: [`Objective`](../../losses/objective.py).

## Metrics to watch

- `success_once`: WHAT IT TELLS HERE;
- `train_success`: LIKEWISE;
- `bc_nll`: LIKEWISE.

All of them: [metrics](../metrics.md).

## Results

<!-- generated: results -->

### Over frames

A thin line is a seed, the thick one their interquartile mean.

<!-- generated: curve -->

### Other tasks and rewards

All cells, costs and what is missing: [the table over tasks](../results/tasks/README.md).

<!-- generated: cells -->

## Departures from the paper

<!-- generated: departures -->
"""


def skeleton(name: str) -> str:
    """The page, with the first sentence of the variant's file as its idea.

    Raises:
        KeyError: There is no such variant.
    """
    says = (variants.comments(variants.variant_files()[name]) or [name])[0]
    idea = says.split(": ")[-1].split(". ")[0].rstrip(".").replace(":", ",")
    return TEMPLATE.format(name=name, idea=idea, title=name.upper())


def main(name: str, folder: Path = METHODS) -> None:
    """Writes the page.

    Raises:
        SystemExit: There is no such variant, or its page is there already.
    """
    if name not in variants.variant_files():
        sys.exit(f"configs/variant/{name}.yaml is not there: write the variant first")
    path = folder / f"{name}.md"
    if path.exists():
        sys.exit(f"{path} is there already")
    path.write_text(skeleton(name))
    print(f"written to {path}: fill in what is in capitals")  # noqa: T201 - a command's output


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else sys.exit("usage: python -m docs.site.new_page NAME"))

"""Parts of `ifo report`: rows, tables, plots, videos, lineage, and the page that shows them."""

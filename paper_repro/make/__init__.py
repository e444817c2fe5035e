"""How the report is made: artefacts and their jobs, tables and figures as files, the catalogue, the pages."""

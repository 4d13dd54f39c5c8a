"""One file per report format; each is a pure function of the `certification.document.Report`."""

"""Studies of the update and of the law: charts, maps, figures, benchmarks. The rest of the package never imports them."""

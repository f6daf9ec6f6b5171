"""Describes benches. A bench is the equipment and the site for which a plan is made. This package contains bench files, the models
made from them, the connected bench and its clock."""

; Everything shares its name with something else, and the case is mixed.
(DEFINE (DOMAIN Kitchen)
  (:REQUIREMENTS :Strips :TYPING :made-up-by-the-author)
  (:TYPES Zone Dish Cook)
  (:CONSTANTS Stove Table - Zone)
  (:PREDICATES (AT ?c - COOK ?z - zone) (Cook ?d - dish) (served ?d - Dish) (Stove ?z - zone) (hot ?z - Zone))
  (:FUNCTIONS)
  (:ACTION Cook
    :PARAMETERS (?Who - cook ?What - dish)
    :PRECONDITION (AND (at ?WHO stove) (Hot Stove))
    :EFFECT (cook ?what))
  (:action at
    :parameters (?c - cook ?from ?to - zone)
    :precondition (and (at ?c ?from) (not (= ?from ?to)))
    :effect (and (not (at ?c ?from)) (at ?c ?to)))
  (:action heat
    :effect (when (stove stove) (hot stove)))
  (:action SERVE
    :parameters (?c - Cook ?d - dish)
    :precondition (and (at ?c table) (cook ?d))
    :effect (and (served ?d) (not (cook ?d)))))

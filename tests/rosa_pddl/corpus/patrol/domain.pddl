(define (domain patrol)
(:requirements :strips :typing :adl :fluents :durative-actions)

;; Types ;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;
(:types
robot - object
waypoint
charging_point - waypoint
);; end Types ;;;;;;;;;;;;;;;;;;;;;;;;;

;; Predicates ;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;
(:predicates
(robot_at ?r - robot ?wp - waypoint)
(connected ?from ?to - waypoint)
(patrolled ?wp - waypoint)
(battery_low ?r - robot)
(battery_full ?r - robot)
(free ?r - robot)
);; end Predicates ;;;;;;;;;;;;;;;;;;;;
;; Functions ;;;;;;;;;;;;;;;;;;;;;;;;;
(:functions
);; end Functions ;;;;;;;;;;;;;;;;;;;;
;; Actions ;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;;
(:durative-action move
    :parameters (?r - robot ?from ?to - waypoint)
    :duration ( = ?duration 5)
    :condition (and
        (at start(connected ?from ?to))
        (at start(robot_at ?r ?from))
        (over all(battery_full ?r))
        (at start(free ?r))
        )
    :effect (and
        (at start(not(robot_at ?r ?from)))
        (at start(not(free ?r)))
        (at end(robot_at ?r ?to))
        (at end(free ?r))
    )
)

(:durative-action patrol
    :parameters (?r - robot ?wp - waypoint)
    :duration (and (>= ?duration 2) (<= ?duration 10))
    :condition (over all(robot_at ?r ?wp))
    :effect (at end(patrolled ?wp))
)

(:durative-action charge
    :parameters (?r - robot ?cp - charging_point)
    :duration ( = ?duration 5)
    :condition (and
        (at start (and (robot_at ?r ?cp) (battery_low ?r)))
        (over all (robot_at ?r ?cp)))
    :effect (and
         (at end(not(battery_low ?r)))
         (at end(battery_full ?r))
    )
)

);; end Domain ;;;;;;;;;;;;;;;;;;;;;;;;
